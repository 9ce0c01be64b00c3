"""The fault campaign: runs of every protocol on the virtual bench, with things going wrong."""
