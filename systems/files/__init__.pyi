from .renamed import current_name as current_name
from .typed_yaml import ConfigurationError as ConfigurationError
from .typed_yaml import assign as assign
from .typed_yaml import load_typed as load_typed
from .typed_yaml import read_yaml as read_yaml
from .typed_yaml import suggest as suggest
from .writing import write_atomically as write_atomically
from .writing import write_json as write_json
