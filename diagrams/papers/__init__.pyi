from .registry import reproduce as reproduce
