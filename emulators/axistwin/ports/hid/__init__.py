"""USB HID: devices that the kernel makes of a program's words."""
