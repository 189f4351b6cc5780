"""``axistwin rack``: the lines and buses of a file in one process."""
