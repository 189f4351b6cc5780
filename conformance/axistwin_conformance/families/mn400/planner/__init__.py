"""How the axes of an MN400 must move: speeds, vector moves, circles, contours, pulses.

Everything here is arithmetic: a move goes in, and out come its duration and where each axis may be
at a time.  Times are seconds since the motion began, speeds are steps per second of the major axis,
both exact fractions; only square roots are cut off, at 2^-40, and angles are floats.
"""
