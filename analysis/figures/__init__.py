"""Style and wording of figures and tables, and figures that several reports use."""
