"""The live view and the view file, in Rerun."""
