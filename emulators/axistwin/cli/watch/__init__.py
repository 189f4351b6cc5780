"""``axistwin watch``: what the devices of a daemon do, in a terminal."""
