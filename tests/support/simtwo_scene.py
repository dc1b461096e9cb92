"""An arm as a scene of SimTwo, with the stiffness of its spring to be filled in."""

ARM = """
<robot>
  <defines><const name="L" value="0.4"/><const name="half" value="L/2"/></defines>
  <solids>
    <cylinder><ID value="post"/><mass value="2"/><size radius="0.05" z="2*half"/><pos z="half"/></cylinder>
    <cuboid><ID value="boom"/><size x="L" y="0.1" z="0.02"/><mass value="1"/><pos x="sqrt(L^2)/2" z="L"/>
      <rot_deg z="90"/></cuboid>
    <sphere><ID value="ball"/><radius value="0.03"/><mass value="0.5"/><pos x="L" z="L"/></sphere>
  </solids>
  <articulations>
    <default><motor ri="2" ki="0.02" vmax="12" active="1"/><gear ratio="100"/>
      <controller mode="pidposition" kp="3" ki="0.5" kd="7" active="1" period="20"/></default>
    <joint><ID value="turn"/><pos z="0"/><axis z="1" x="0"/><connect B1="post" B2="world"/><type value="Hinge"/></joint>
    <joint><ID value="cardan"/><pos z="L"/><axis x="0" y="1"/><axis2 x="1" y="0" z="0"/><connect B1="post" B2="boom"/>
      <limits Min="-30" Max="40"/><type value="Universal"/><motor2 active="0"/></joint>
    <joint><ID value="lift"/><pos x="L" z="L"/><axis x="0" z="1"/><connect B1="boom" B2="ball"/><limits Min="-0.1"
      Max="0.2"/><type value="Slider"/><spring k="%s"/></joint>
  </articulations>
</robot>
"""
