"""Search for the effects that explain the gap."""
