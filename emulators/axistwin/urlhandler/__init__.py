"""pyserial's URL scheme axistwin://."""
