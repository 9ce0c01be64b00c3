"""What sets the muscle's pressure: one interface, one file for each kind of source."""
