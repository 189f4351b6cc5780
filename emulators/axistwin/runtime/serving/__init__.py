"""What serves a line or a bus to clients: the loop, its alarm, the servers."""
