"""The panels that the live view and the view file show, one layout per protocol."""
