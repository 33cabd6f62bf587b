"""A data logger for Modbus devices."""
