from .hand import Hand as Hand
from .hand import OperatorHand as OperatorHand
from .insertion import Insertion as Insertion
from .insertion_parameters import FeedParameters as FeedParameters
from .insertion_parameters import InsertionParameters as InsertionParameters
from .insertion_parameters import Push as Push
