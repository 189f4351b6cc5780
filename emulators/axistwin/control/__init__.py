"""The control API: the devices of a rack over HTTP and WebSocket; needs the extra ``control``."""
