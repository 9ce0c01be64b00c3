"""Results of each test for its report: numbers, sentences, sections; comparison with the thesis."""
