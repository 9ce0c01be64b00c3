"""Drivers of the instruments beside the muscle: text, Modbus and SCPI."""
