from .dataset import make_dataset as make_dataset
