"""The figures of a report, by kind; nothing here writes a file but `catalogue`."""
