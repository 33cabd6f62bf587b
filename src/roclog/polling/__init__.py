"""The straight path of each kind of data that a device has: read, judge, decode, write."""
