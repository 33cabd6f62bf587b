"""Samples to MCAP and back. Nothing outside this package knows the MCAP library."""
