"""Camera frames to muscle length."""
