"""What people have done to a device, apart from recording."""
