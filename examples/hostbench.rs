use smr_gpu::{model::*, host::HostPlan, ops::*, tensor::*};
fn main() {
    let w = Weights::open("weights/smrnet.safetensors".as_ref()).unwrap();
    let config = w.config().clone();
    let th = Thresholds { score: 0.05, iou: 0.5, max_detections: 100, class_mask: u32::MAX };
    let net = Network::new(w, 1_000_000, th).unwrap();
    let pic = image::open(std::env::args().nth(1).unwrap()).unwrap().to_rgba8();
    let px: Vec<u32> = bytemuck::pod_collect_to_vec(pic.as_raw());
    let crop = smr_gpu::cpu::Crop::central(pic.width() as usize, pic.height() as usize);
    let pixels: Value = Tensor::new([px.len()], px).unwrap().into();
    let sq: Value = crop.to_tensor(1_000_000).unwrap().into();
    let inputs = [(net.picture, &pixels), (net.crop, &sq)];
    let t = std::time::Instant::now();
    let mut plan = HostPlan::new(&net.graph, &[]).unwrap();
    println!("build {:?} {:?}", t.elapsed(), config.input_size);
    let mut best: Vec<f64> = vec![f64::MAX; 32]; let mut total = f64::MAX; let mut names = vec![];
    for _ in 0..15 {
        let t = std::time::Instant::now();
        let (v, times) = plan.run(&net.graph, &inputs).unwrap();
        total = total.min(t.elapsed().as_secs_f64()*1e3);
        for (i, x) in times.iter().enumerate() { best[i] = best[i].min(x.time.as_secs_f64()*1e3); }
        names = times.iter().map(|x| x.stage.clone()).collect::<Vec<_>>();
        if total == 0.0 { println!("{:?}", v.len()); }
    }
    for (n, b) in names.iter().zip(&best) { println!("{n:20} {b:.2}"); }
    println!("total {total:.2} ms");
    let keep = net.graph.computed();
    let mut plan = HostPlan::new(&net.graph, &keep).unwrap();
    let (got, _) = plan.run(&net.graph, &inputs).unwrap();
    let (want, _) = net.graph.reference(&inputs, &keep).unwrap();
    for id in keep {
        if let (Value::F32(g), Value::F32(w)) = (&got[&id], &want[&id]) {
            println!("{:40} {:.2e}", net.graph.name(id), smr_gpu::comparison::relative_l2(g.data(), w.data()));
        }
    }
}
