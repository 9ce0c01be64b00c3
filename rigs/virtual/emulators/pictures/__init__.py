"""What the cameras of the virtual bench see."""
