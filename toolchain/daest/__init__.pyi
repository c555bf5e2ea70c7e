"""The public names for editors and type checkers; at run time each is imported when it is first used."""

from daest.data.check import check_experiment as check_experiment
from daest.data.prepare import resample as resample
from daest.data.project import load_project as load_project
from daest.data.read import Signal as Signal
from daest.data.read import read_experiments as read_experiments
from daest.diagnosis.comparison.compare import compare_models as compare_models
from daest.diagnosis.comparison.trial import Candidate as Candidate
from daest.errors import DaestError as DaestError
from daest.estimation.filter import run_filter as run_filter
from daest.estimation.fitting.fitted import fitted_model as fitted_model
from daest.fmu.export import export_fmu as export_fmu
from daest.fmu.linearize import linearize_fmu as linearize_fmu
from daest.fmu.load import load_fmu as load_fmu
from daest.fmu.load import symbolic_model as symbolic_model
from daest.front import Source as Source
from daest.front import check as check
from daest.front import compare as compare
from daest.front import diagnose as diagnose
from daest.front import filter as filter
from daest.front import identify as identify
from daest.front import improve as improve
from daest.front import linearize as linearize
from daest.front import noise as noise
from daest.front import simulate as simulate
from daest.model.estimates import FilterOptions as FilterOptions
from daest.model.estimates import InitialState as InitialState
from daest.model.experiment import Experiment as Experiment
from daest.model.fit import IdentifyOptions as IdentifyOptions
from daest.model.parts import Prior as Prior
from daest.modelica.change import declare as declare
from daest.modelica.change import with_values as with_values
from daest.modelica.compile import compile_model as compile_model
from daest.modelica.effects.attach import attach as attach
from daest.modelica.effects.catalogue import effect_library as effect_library
from daest.modelica.effects.catalogue import find_effect as find_effect
from daest.modelica.effects.extend import extend_model as extend_model
from daest.systems.linear.linearize import linear_dae_function as linear_dae_function
from daest.systems.linear.noise import noise_report as noise_report
from daest.systems.linear.split import split as split
from daest.systems.linear.state_space import sample as sample
from daest.systems.linear.state_space import state_space as state_space
from daest.systems.linear.state_space import state_space_family as state_space_family
from daest.systems.linear.transfer import poles as poles
from daest.systems.linear.transfer import transfer_functions as transfer_functions
from daest.systems.reduction.initialize import initial_point as initial_point
from daest.systems.reduction.reduce import reduce_index as reduce_index

__version__: str
__all__: list[str]
