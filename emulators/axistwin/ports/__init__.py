"""Ports: ptys, TCP, RFC 2217."""
