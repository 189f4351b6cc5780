"""MN400 four-axis step and direction controllers: packets, commands, states, store and motion."""
