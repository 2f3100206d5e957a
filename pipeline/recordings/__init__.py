"""A folder of recordings: read, validated, written, cut into windows."""
