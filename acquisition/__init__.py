"""Devices and capture sessions."""
