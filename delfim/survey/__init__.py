"""Surveys, ashore: an area becomes lines in the order in which a boat sails them, and soundings become a chart
(docs/survey.md). Nothing runs aboard."""
