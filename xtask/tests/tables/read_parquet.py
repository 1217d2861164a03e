"""Compares the tables of an analysis as Parquet with those as CSV: FOLDER. Prints the number of rows of each."""

import csv
import pathlib
import sys

try:
    import pyarrow.parquet
except ImportError:
    print("absent")
    sys.exit()

folder = pathlib.Path(sys.argv[1])
for name in ["messages", "events"]:
    table = pyarrow.parquet.read_table(folder / f"{name}.parquet")
    rows = table.to_pylist()
    with open(folder / f"{name}.csv", newline="") as file:
        reader = csv.DictReader(file)
        expected = list(reader)
        assert reader.fieldnames == table.column_names, (reader.fieldnames, table.column_names)
    assert len(rows) == len(expected), (name, len(rows), len(expected))
    for row, text in zip(rows, expected):
        for column, value in row.items():
            if column == "time_s":
                assert abs(value - float(text[column])) < 1.5e-6, (row, text)
            elif isinstance(value, float):
                decimals = len(text[column].partition(".")[2])
                assert f"{value:.{decimals}f}" == text[column], (row, text)
            else:
                assert value == text[column], (row, text)
    print(name, len(rows))
