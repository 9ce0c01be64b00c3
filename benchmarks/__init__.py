"""Side by side with what a user would pick instead; ratios in one run."""
