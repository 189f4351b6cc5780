"""Motion in closed form: position at a time, time of an increment.  Pure."""
