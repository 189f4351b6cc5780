"""The checks of the MSC."""
