from .cluster import Cluster as Cluster
from .opening import open_cluster as open_cluster
