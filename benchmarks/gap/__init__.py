"""The diagnosis timed: beside other methods, over size and number of cores."""
