from .page import write_report as write_report
from .paper import StudyConfig as StudyConfig
from .paper import check_n_images as check_n_images
from .results import read_run as read_run
from .run import Study as Study
from .run import check_data as check_data
