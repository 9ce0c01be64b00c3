"""What protocols are made of: the keys that their files share, and the trials that they order."""
