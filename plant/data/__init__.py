"""The thesis tables, as printed."""
