"""Method of Carriere 2016 as published."""
