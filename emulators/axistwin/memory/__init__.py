"""Nonvolatile memory: cells, their record format, nothing about disks."""
