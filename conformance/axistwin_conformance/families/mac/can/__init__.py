"""MAC23 on CAN: the suite's own reading of the manual, and its checks."""
