"""Octets in, answers out: requests, RTU frames, MBAP frames. No sockets, no clock, no logging."""
