"""The toolkit of reports: one table, figures, one page; what they are of stands elsewhere."""
