"""Maps: DT, regime and impacts over two or three parameters, measured on the mechanics alone, and the best gap.

No instruments, no analysis of scans, no noise: what is measured here is what the mechanics do, and named so.
"""
