"""Speed and accuracy beside their peers; ``python -m benchmarks`` runs all of them."""
