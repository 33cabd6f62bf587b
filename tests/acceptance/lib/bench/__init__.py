"""The test bench: real processes around a recorder, and judges that know nothing of its code."""
