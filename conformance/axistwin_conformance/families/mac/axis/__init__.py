"""What both faces of the MAC share: the axis."""
