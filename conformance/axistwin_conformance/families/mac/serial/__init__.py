"""MAC23 and MAC34 on the serial line: the suite's own reading of the manual, and its checks."""
