within Daest.Blocks.Interfaces;
connector RealInput = input Real "Real signal that enters a component";
