"""The panels of the live view and the view file, one layout per protocol."""
