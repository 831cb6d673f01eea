"""Method of Zhao 2012 as published."""
