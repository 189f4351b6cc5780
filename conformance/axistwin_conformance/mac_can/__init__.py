"""The MAC23 on a CAN bus: frames, exchanges and what a module has to make of them."""
