"""Proves that every machine gives the same bits: fixed runs, their digests, and masks that make one CPU look older."""
