from .plan import Plan as Plan
from .recording import RecordingConfig as RecordingConfig
from .recording import acquire_from as acquire_from
from .simulated import AcquisitionConfig as AcquisitionConfig
from .simulated import acquire as acquire
