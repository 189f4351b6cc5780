"""``axistwin plot``: what is drawn, where it comes from, and how it is drawn."""
