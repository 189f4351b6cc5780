"""The ports of an MN400: packets, reports, what is received and what is sent."""
