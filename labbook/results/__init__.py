"""Results of a study from its lab: points, series, fits, references and statements. Each number is measured once."""
