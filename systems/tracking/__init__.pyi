from .line_follower import LineFollower as LineFollower
from .line_belief import BeliefParameters as BeliefParameters
