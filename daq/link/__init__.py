"""Transport, framing, message codec, telemetry and clock fit of devices."""
