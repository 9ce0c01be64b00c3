"""Bytes and time: transport, framer, clock, acquisition, record, run store, live view."""
