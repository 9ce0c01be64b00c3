"""Style and wording of figures and tables, and the figures that several reports share."""
