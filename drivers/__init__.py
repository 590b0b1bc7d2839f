"""Devices and their protocols: bytes to samples and fixes. `README.md` shows how to add a sensor."""
