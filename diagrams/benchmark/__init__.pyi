from .benchmark import BenchmarkOptions as BenchmarkOptions
from .benchmark import BenchmarkResult as BenchmarkResult
from .benchmark import run_benchmark as run_benchmark
from .making import make_volumes as make_volumes
from .report import benchmark_table as benchmark_table
from .report import write_benchmark as write_benchmark
from .sequence import load_suites as load_suites
