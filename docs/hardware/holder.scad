// A steel ball on a stalk, for a printer's carriage in place of its hot end. Lengths in mm.
// Print it upside down, plate on the bed, without supports; glue the ball into its cup.
// A picture: openscad -o holder.png --imgsize 900,900 --camera 0,0,-14,65,0,30,170 holder.scad
ball = 6;            // diameter: sensor.toml's indenter_diameter_mm
stalk = 40;          // from the plate to the ball's lowest point
thick = 12;          // the stalk's diameter at the plate; at the cup it is the ball's own
plate = [44, 24, 5];
screw = 3.4;         // M3 with play
apart = [30, 34];    // slots take screws this far apart, at least and at most
$fn = 96;

module slot(x) {
    length = (apart[1] - apart[0]) / 2;
    hull() for (d = [0, length])
        translate([x + sign(x) * d, 0, -1]) cylinder(d = screw, h = plate[2] + 2);
}

difference() {
    union() {
        translate([-plate[0] / 2, -plate[1] / 2, 0]) cube(plate);
        // The cup holds the ball's upper third, so that nothing but the ball can touch the skin.
        translate([0, 0, -(stalk - 2 * ball / 3)]) cylinder(d1 = 0.9 * ball, d2 = thick, h = stalk - 2 * ball / 3);
    }
    translate([0, 0, -(stalk - ball / 2)]) sphere(d = ball + 0.1);
    for (side = [-1, 1]) slot(side * apart[0] / 2);
}
// The ball itself: shown in the preview, not printed.
%translate([0, 0, -(stalk - ball / 2)]) sphere(d = ball);
