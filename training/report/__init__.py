"""The report: results beside the paper's, as one HTML page and as Markdown with pictures.

It reads results, learning curves and the paper's figures, and plays nothing.
"""
