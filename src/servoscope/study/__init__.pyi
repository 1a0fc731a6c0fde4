from .config import StudyConfig as StudyConfig
from .config import check_n_images as check_n_images
from .run import Study as Study
from .run import check_data as check_data
from .run_folder import RunFolder as RunFolder
from .run_folder import open_run_folder as open_run_folder
