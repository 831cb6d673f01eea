from .anatomies import LabelMapAnatomy as LabelMapAnatomy
from .anatomies import LiverAnatomy as LiverAnatomy
from .anatomies import liver_label_map as liver_label_map
from .anatomy_grid import AnatomyParameters as AnatomyParameters
from .anatomy_grid import LabelProperties as LabelProperties
from .label_map import LabelMap as LabelMap
from .label_map import read_label_map as read_label_map
from .label_map import write_label_map as write_label_map
