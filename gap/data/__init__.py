"""The dataset format, its readers, and checks of data quality."""
