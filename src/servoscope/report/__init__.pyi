from .agreement import Finding as Finding
from .agreement import compare_with_paper as compare_with_paper
from .html import write_report as write_report
from .run_data import RunData as RunData
from .run_data import read_run as read_run
