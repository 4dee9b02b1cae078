"""Surveys, ashore: an area becomes lines in the order in which a boat sails them (docs/survey.md). Nothing runs aboard."""
