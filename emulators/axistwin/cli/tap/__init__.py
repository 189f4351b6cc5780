"""Between a program and its device: all that they say to each other is passed on and recorded."""
