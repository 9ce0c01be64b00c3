"""Measured data of others put to the diagnosis: `make real DATA=FOLDER`."""
