"""One file for each test protocol: its parameters, its method, its table and its screen."""
