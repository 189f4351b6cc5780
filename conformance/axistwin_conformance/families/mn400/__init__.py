"""The MN400 4-axis step and direction controller of MicroKinetics, on its serial line."""
