"""Questions to an MN400 on USB."""
