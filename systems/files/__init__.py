"""The boundary to files: typed YAML, files of voxels, budgets of memory, and atomic writing.

Errors in a setting name its field. Whatever fails while a file is read becomes one line that names
the file. A file is written completely or not at all. The package imports only `models`.
"""
