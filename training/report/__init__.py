"""The report: what was measured, beside the paper, as one HTML page and as Markdown with pictures.

It reads results, learning curves and the paper's figures, and runs nothing.
"""
