"""Who speaks when. The only sockets and serial ports of the logger are in this package."""
