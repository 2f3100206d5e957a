"""SHA-256 without OpenSSL."""

try:
    # hashlib loads OpenSSL, 4 MB of memory that nothing else on a device needs.
    from _sha2 import sha256
except ImportError:
    try:
        from _sha256 import sha256  # Python 3.11
    except ImportError:
        from hashlib import sha256

__all__ = ["sha256"]
