"""A validation's tables in the terminal."""

from analysis.validation import Validation, both_tables
from standoff.terminal.output import print_table


def print_validation(validation: Validation) -> None:
    """Print both tables, the paper's rows below ours."""
    for table in both_tables(validation):
        print_table(
            table.title, list(table.columns), [list(r) for r in (*table.rows, *table.paper)]
        )
