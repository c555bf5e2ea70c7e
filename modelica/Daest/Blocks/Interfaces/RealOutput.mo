within Daest.Blocks.Interfaces;
connector RealOutput = output Real "Real signal that leaves a component";
