"""Commands on the bench itself: calibrate."""
