"""Measuring what the paper measured: cases, summaries and comparisons. Knows no ROS."""
