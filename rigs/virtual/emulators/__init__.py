"""Emulated instruments, one per device, each speaking the real bytes."""
