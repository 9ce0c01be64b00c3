// The bright gap in each picture named on standard input, by ImageJ's own particle analyser:
// Otsu threshold, the largest particle's area over the picture's height, its tilt taken out by
// the fitted ellipse. One line a picture: pixels, microseconds of this
// thread's processor time (the last of five passes: compiled by then).
import ij.ImagePlus;
import ij.io.Opener;
import ij.measure.Measurements;
import ij.measure.ResultsTable;
import ij.plugin.filter.ParticleAnalyzer;
import ij.process.ImageProcessor;
import java.io.BufferedReader;
import java.io.InputStreamReader;
import java.lang.management.ManagementFactory;
import java.lang.management.ThreadMXBean;
import java.util.ArrayList;
import java.util.List;

public class ImageJGap {
    static double measure(ImagePlus picture) {
        ImageProcessor pixels = picture.getProcessor();
        pixels.resetThreshold();
        pixels.setAutoThreshold("Otsu dark");
        ResultsTable table = new ResultsTable();
        new ParticleAnalyzer(0, Measurements.AREA + Measurements.ELLIPSE, table, 1000,
                Double.POSITIVE_INFINITY).analyze(picture, pixels);
        double area = Double.NaN, angle = 90;
        for (int i = 0; i < table.getCounter(); i++) {
            if (!(table.getValue("Area", i) <= area)) {
                area = table.getValue("Area", i);
                angle = table.getValue("Angle", i);
            }
        }
        return area / picture.getHeight() * Math.sin(Math.toRadians(angle));
    }

    public static void main(String[] none) throws Exception {
        BufferedReader in = new BufferedReader(new InputStreamReader(System.in));
        List<ImagePlus> pictures = new ArrayList<>();
        for (String path; (path = in.readLine()) != null; ) {
            pictures.add(new Opener().openImage(path));
        }
        ThreadMXBean clock = ManagementFactory.getThreadMXBean();
        for (int pass = 0; pass < 5; pass++) {
            for (ImagePlus picture : pictures) {
                long begin = clock.getCurrentThreadCpuTime();
                double gap = measure(picture);
                double took = (clock.getCurrentThreadCpuTime() - begin) * 1e-3;
                if (pass == 4) {
                    System.out.println(gap + " " + took);
                }
            }
        }
        System.out.println("ImageJ " + ij.IJ.getVersion());
    }
}
