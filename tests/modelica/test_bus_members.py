"""Members that connections give to expandable connectors."""

import numpy as np
import pytest

from daest.modelica.forms.bus_members import bus_members, expandable_connectors, with_members
from daest.modelica.language.components import Classes
from daest.systems.simulation.simulate import simulate

PLANT = """package Plant
  connector Input = input Real;
  connector Output = output Real;
  connector Port
    Real T;
    flow Real Q;
  end Port;
  expandable connector Signals "Between sensors and controllers"
  end Signals;
  expandable connector Lines
  end Lines;
  model Sensor
    Output y;
    Signals bus;
    Real x(start = 1, fixed = true);
  equation
    der(x) = -x;
    y = x;
    connect(y, bus.speed);
  end Sensor;
  model Body
    parameter Real T = 300;
    parameter Real G = 0.5;
    Port port;
  equation
    port.Q = G*(port.T - T);
  end Body;
  model Heated
    Body body;
    Lines lines;
  equation
    connect(body.port, lines.heat);
  end Heated;
  model Controller
    Input u[2];
    Signals bus;
    Output level;
  equation
    level = 3*u[1];
    u[2] = 2;
    connect(bus.speed, u[1]);
  end Controller;
  model Whole
    Sensor sensor;
    Controller controller;
    Heated heated;
    Body source(T = 310, G = 2);
    Signals bus;
    output Real z = controller.level;
    output Real T = source.port.T;
  equation
    connect(sensor.bus, bus);
    connect(bus, controller.bus);
    connect(heated.lines.heat, source.port);
  end Whole;
end Plant;
"""


def test_members_are_those_of_the_connections():
    text = PLANT.encode()
    classes = Classes(lambda name: text if name == "Plant" else None)
    found = bus_members(classes, [text])
    assert found["Plant.Signals"] == {"speed": "Real"}
    assert found["Plant.Lines"] == {"heat": ".Plant.Port"}
    made = with_members(text, found).decode()
    assert 'Signals "Between sensors and controllers" Real speed;\n' in made
    assert len(made.splitlines()) == len(PLANT.splitlines())


def test_connectors_are_told_from_words_in_comments():
    text = b"package P // expandable connector A\n  expandable connector B end B;\nend P;"
    assert set(expandable_connectors(text)) == {"P.B"}


def test_a_bus_without_declared_members_is_simulated(compiled):
    time = np.linspace(0, 1, 11)
    z, temperature = simulate(compiled(PLANT, "Plant.Whole"), (time, np.zeros((11, 0)))).outputs.T
    assert z == pytest.approx(3 * np.exp(-time), rel=1e-6)
    assert temperature == pytest.approx(np.full(11, (0.5 * 300 + 2 * 310) / 2.5))
