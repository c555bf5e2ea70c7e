"""The registry of data formats. A new format is a file in this folder, with a function that reads it, and a
row here."""

from __future__ import annotations

# Ending of a file -> the file of this folder, and its function (path, part) -> Table, which may read more.
FORMATS = {
    ".csv": ("csv_file", "read_csv"),
    ".txt": ("csv_file", "read_csv"),
    ".tsv": ("csv_file", "read_csv"),
    ".mat": ("mat_file", "read_mat"),
    ".parquet": ("parquet_file", "read_parquet"),
    ".xlsx": ("excel_file", "read_excel"),
    ".dat": ("csv_file", "read_csv"),
}
