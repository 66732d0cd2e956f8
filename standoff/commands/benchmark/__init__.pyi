from .group import benchmark as benchmark
