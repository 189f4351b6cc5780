"""The control API of a rack whose lines are served by several worker processes."""
