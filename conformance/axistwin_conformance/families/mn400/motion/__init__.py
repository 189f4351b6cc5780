"""Motion of an MN400 under test: the bounds it is held to, how it is begun and watched, the way
home, and what a rig works while it moves."""
