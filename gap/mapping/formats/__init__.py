"""Files of other programs as columns: CSV, Parquet, MAT, HDF5, TDMS, MCAP."""
