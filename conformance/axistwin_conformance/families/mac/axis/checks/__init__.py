"""The checks of the axis, whichever face it has."""
