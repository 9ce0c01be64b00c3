"""Bytes in and out: transport, framer, codec, telemetry, clock fit."""
