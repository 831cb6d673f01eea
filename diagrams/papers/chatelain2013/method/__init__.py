"""Method of Chatelain 2013 as published."""
