from .outcome import Assessment as Assessment
from .result import as_json as as_json
from .run import assess as assess
