"""The response map: what the accelerometers show for a contact at a place, calibrated to a sensor."""
