"""From a fitted explanation to a verdict with its reliability."""
